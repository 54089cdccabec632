"""Write a problem of single drones for any N as a problem file.

Usage: python problems/swarm.py circle DRONES | grids SIDE | door WIDTH DRONES | stack DRONES |
random SEED > problem.yaml
"""

import sys

from ruamel.yaml import YAML

from hitchopt.mission import swarm_problems

if __name__ == "__main__":
    kind, *words = sys.argv[1:]
    if kind == "door":
        data = swarm_problems.through_a_door(float(words[0]), int(words[1]))
    else:
        make = {
            "circle": swarm_problems.antipodal_circle,
            "grids": swarm_problems.swapping_grids,
            "stack": swarm_problems.reversed_stack,
            "random": swarm_problems.random_team,
        }[kind]
        data = make(int(words[0]))
    yaml = YAML()  # keeps the keys in their order
    yaml.default_flow_style = None
    yaml.dump(data, sys.stdout)
