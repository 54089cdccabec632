"""Commands of drone-controllers' Mellinger law, in a process of its own: it sets up scipy anew.

Cases come as JSON from standard input: position, quaternion, velocity, rates, setpoint, and the
rates of a second look. Each is answered by the thrust command and both torques.
"""

import json
import sys

import numpy as np
from drone_controllers import parametrize
from drone_controllers.mellinger import attitude2force_torque, state2attitude

AIM = parametrize(state2attitude, "cf2x_L250")
TURN = parametrize(attitude2force_torque, "cf2x_L250")


def answer(case: list[list[float]]) -> list[object]:
    """Return the thrust command and the torques at both rates, in the firmware's units."""
    *body, goal, faster = map(np.array, case)
    wanted, _ = AIM(*body, goal, kd=np.array([0.2, 0.2, 0.4]), ctrl_freq=250)
    torques = [
        np.array(TURN(*body[:3], each, wanted, prev_ang_vel=body[3], torque_pwm_max=1e9)[1])
        for each in (body[3], faster)
    ]
    return [float(wanted[3]), *(torque.tolist() for torque in torques)]


if __name__ == "__main__":
    sys.stdout.write(json.dumps([answer(case) for case in json.load(sys.stdin)]))
