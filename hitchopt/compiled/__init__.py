"""Compiled code for what is called many times: an extra, with numpy's path beside it."""
