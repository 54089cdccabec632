"""Legs that lean against friction while cables slide."""
