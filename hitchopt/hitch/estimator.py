"""Parameters of the Crazyflie's extended Kalman filter."""

from __future__ import annotations

from dataclasses import dataclass

from hitchopt.errors import OneLine
from hitchopt.values import positive


@dataclass(frozen=True)
class EstimatorParameters(OneLine):
    """Noise parameters of the estimator; the defaults are those that exports set.

    The filter predicts from the thrust axis and the gyroscope alone. A horizontal cable force shows
    only in its prediction error. If the process noise is small compared with that force, the filter
    attributes it to a false tilt or velocity.

    Parameters
    ----------
    level_noise, upright_noise: process noise of the acceleration along the body's x and y, and
        along its z (``kalman.pNAcc_xy``, ``kalman.pNAcc_z``) [m/s²].
    position_error: standard deviation of captured positions (``locSrv.extPosStdDev``) [m].
    attitude_error: standard deviation of captured attitudes (``locSrv.extQuatStdDev``) [rad]; None
        for drones with one marker, which has no attitude.

    Raises
    ------
    InputError: a number that is not positive.
    """

    level_noise: float = 20.0
    upright_noise: float = 20.0
    position_error: float = 1e-3
    attitude_error: float | None = 1e-2

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None:
                object.__setattr__(self, name, positive(name, value))

    @property
    def firmware_params(self) -> dict[str, dict[str, float]]:
        """The firmware's parameters by group and name, as crazyflies.yaml holds them."""
        kalman = {"pNAcc_xy": self.level_noise, "pNAcc_z": self.upright_noise}
        errors = {"extPosStdDev": self.position_error}
        if self.attitude_error is not None:
            errors["extQuatStdDev"] = self.attitude_error
        return {"kalman": kalman, "locSrv": errors}


HELD = EstimatorParameters()  # Values that exports set for rigid bodies of several markers
FIRMWARE = EstimatorParameters(0.5, 1.0, 1e-2, 4.5e-3)  # Defaults of the firmware for rigid bodies

ONE_MARKER = EstimatorParameters(0.5, 1.0, 1e-2, None)
"""Defaults of the firmware for drones with one marker; hitches do not hold with them."""
