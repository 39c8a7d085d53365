"""The command line: options, input files, printed output and exit status of every command."""
