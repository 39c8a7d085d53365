"""Effects that act on the joints of an arm."""
