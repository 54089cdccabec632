"""Forming, releasing and landing: swaps that tie and untie hitches, and approaches to them."""
