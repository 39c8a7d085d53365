"""The commands of `armdyn`: one file for each command, with the name of the command."""
