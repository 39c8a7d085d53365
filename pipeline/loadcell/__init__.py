"""The load cell, an HX711 on a microcontroller with a serial line (`docs/loadcell.md`), and the detection of faults."""
