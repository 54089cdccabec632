"""Curves refitted to what a format's pieces can be: fewer, of lower degree, of whole durations."""
