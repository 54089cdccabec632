"""Statics: hitches at rest, teams calibrated from recordings, and hitches fitted to objects."""
