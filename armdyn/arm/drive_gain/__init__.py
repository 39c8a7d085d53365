"""Gains, delays and saturation of servo drives, identified from recordings."""
