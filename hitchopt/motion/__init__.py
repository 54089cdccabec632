"""Motions of a team: polynomials, states at given times, plan files, cutting."""
