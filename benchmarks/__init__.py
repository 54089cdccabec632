"""Timings and profiles; nothing here decides whether a test passes."""
