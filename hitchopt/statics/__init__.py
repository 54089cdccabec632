"""Statics: where hitches rest, what recorded flights say of teams, and what hitches fit objects."""
