"""The terminal's side of every command: its options, what it reads, what it prints, how it ends."""
