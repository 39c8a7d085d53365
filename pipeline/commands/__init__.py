"""The commands of `armdyn`, one file each: read arguments, call, print."""
