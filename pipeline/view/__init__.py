"""A 3-D view of a motion (arm, load on its string, path), as an offline page or on the workbench."""
