"""The load cell: an HX711 on a microcontroller, over a serial line (`docs/loadcell.md`); and faults of any cell."""
