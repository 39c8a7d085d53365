"""The page on which a person puts effects into a model and watches the error fall; the state is apart from the page."""
