"""Writes a random room with objects on a table as YAML.

python -m robbie_robots.hw.simulation.table_room --seed 3
"""

import argparse
import math
import sys
from collections.abc import Sequence

import numpy as np

KINDS = {
    "soup": "can: [0.066, 0.10]",
    "tea": "box: [0.06, 0.04, 0.12]",
    "cola": "can: [0.052, 0.14]",
}
TWINS = (("tea", "mint", "soup"), ("soup", "beans", "tea"))
"""Names of the objects in rooms with twins: the first two have the same size, that of the first one."""
TABLE = (3.7, 1.2, 4.3, 2.4)
"""Two opposite corners, m. The robot can stand in front of its left side."""
FROM_EDGE_M, DEEP_M, BESIDE_M = 0.06, 0.17, 0.20
"""Objects stand this far from the table's edge; at most this far from it, and from the middle of its side."""
APART_M = 0.13
MAX_TRIES, RESTART = 10_000, 50
ROOM = """\
# A random room: python -m robbie_robots.hw.simulation.table_room --seed {seed}
cell_m: 0.5
wall_height_m: 0.9
drawing: |
  ############
  #..........#
  #..........#
  #..........#
  #..........#
  #....R.....#
  #..........#
  #..........#
  ############
tables:
  - {{name: table, box: [3.7, 1.2, 4.3, 2.4], height_m: 0.4}}
  - {{name: counter, box: [1.4, 3.3, 2.6, 3.8], height_m: 0.4}}
objects:
"""


class ObjectsDoNotFit(ValueError):
    """The objects found no places."""


def generate_room(seed: int, has_twins: bool = False) -> str:
    """Return a random room as the text of an arena file.

    Three objects stand on a table, at random places and turned at random, where the stock robot with an arm
    reaches them.

    Args:
        seed: random seed; the same seed gives the same text.
        has_twins: two of the objects differ only by what is printed on them: boxes for even seeds, cans for
            odd ones.

    Raises:
        CannotBeArranged: the objects found no places; choose another seed.
    """
    random = np.random.default_rng(seed)
    x1, y1, _, y2 = TABLE
    placed: list[tuple[float, float]] = []
    for tried in range(MAX_TRIES):
        if tried % RESTART == 0:
            placed = []  # the first ones may leave no room for the last one
        x = x1 + float(random.uniform(FROM_EDGE_M, DEEP_M))
        y = (y1 + y2) / 2 + float(random.uniform(-BESIDE_M, BESIDE_M))
        if all(math.dist((x, y), other) >= APART_M for other in placed):
            placed.append((x, y))
        if len(placed) == len(KINDS):
            break
    else:
        raise ObjectsDoNotFit(f"found no places for all objects in {MAX_TRIES} tries: choose another seed")
    text = ROOM.format(seed=seed)
    twins = TWINS[seed % 2]
    kinds = {name: KINDS.get(name, KINDS[twins[0]]) for name in twins} if has_twins else KINDS
    names = random.permutation(list(kinds)).tolist()
    for name, (x, y) in zip(names, placed, strict=True):
        yaw = float(random.uniform(-math.pi, math.pi))
        printed = f", print: {print_seed(seed, name)}" if has_twins else ""
        place = f"x_m: {x:.3f}, y_m: {y:.3f}, yaw_rad: {yaw:.3f}"
        text += f"  - {{name: {name}, {kinds[name]}, {place}{printed}}}\n"
    return text


def print_seed(seed: int, name: str) -> int:
    """Return the seed of what is printed on an object of a room with twins."""
    return 10 * seed + ["tea", "mint", "soup", "beans"].index(name)


def main(words: Sequence[str] | None = None) -> int:
    """Write a room to standard output. `words` are the arguments of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m robbie_robots.hw.simulation.table_room",
        description="Write a random room with objects on a table as YAML to standard output.",
    )
    parser.add_argument("--seed", type=int, required=True, help="the same seed makes the same room")
    parser.add_argument("--twins", action="store_true", help="two objects differ only by their print")
    options = parser.parse_args(words)
    try:
        sys.stdout.write(generate_room(options.seed, options.twins))
    except ObjectsDoNotFit as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
