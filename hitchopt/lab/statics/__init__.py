"""Statics: hitches at rest, and teams calibrated from recordings."""
