"""The sections of the reports, one per file."""
