"""The commands of `armdyn`, one file each: the file's name is the command's, and `armdyn --help` lists what is here."""
