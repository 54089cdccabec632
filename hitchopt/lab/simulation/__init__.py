"""Rope simulation of a plan's setpoints in MuJoCo (an extra: needs ``hitchopt[simulate]``)."""
