"""Parameters from recordings: information, fitting, comparison and diagnosis, for any model that predicts."""
