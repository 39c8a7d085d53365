"""The web page on which a user adds effects to a model and sees the error fall; its state is separate."""
