"""A 3-D view of what moved: an arm, a load on its string, a path; the same in one offline page and on the workbench."""
