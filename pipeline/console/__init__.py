"""The terminal side of every command: options, input files, printed output and exit status."""
