"""Waves: a toy slice, with a step, a row of the certificate and a picture."""
