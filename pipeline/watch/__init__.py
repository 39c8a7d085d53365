"""Where a watch gets its samples, and where what it says goes."""
