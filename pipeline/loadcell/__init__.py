"""The load cell: an HX711 on a microcontroller, over a serial line; and faults of any load cell.

Nothing is imported here, so that ``armdyn --help`` stays quick: ``pipeline.loadcell.cell`` (the cell),
``pipeline.loadcell.faults`` (what can go wrong, on any stream of forces), ``pipeline.loadcell.calibration`` and
``pipeline.loadcell.emulator`` are imported by name. The line protocol and the wiring are in ``docs/loadcell.md``.
"""
