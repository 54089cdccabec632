"""Benchmarks that users run: ``python -m benchmarks NAME``, one module each."""
