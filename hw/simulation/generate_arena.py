"""Writes a random arena as YAML.

python -m robbie_robots.hw.simulation.generate_arena --seed 3 > arena.yaml
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import fields

from robbie_robots.hw.simulation.arena_contents import WallSpot
from robbie_robots.hw.simulation.arena_generator import CELL_M, ArenaGenerator, ArenaWishes, CannotBeArranged

APPEARS_FOR_S = 30.0


def generate_arena(seed: int, wishes: ArenaWishes | None = None) -> str:
    """Return a random arena as the text of an arena file.

    The stock robot can reach every place it fits into, and can view every victim from 0.8 m.

    Args:
        seed: random seed; the same seed and wishes give the same text.
        wishes: the wanted contents.

    Raises:
        CannotBeArranged: the arena is too small for its contents.
    """
    wishes = wishes or ArenaWishes()
    made = ArenaGenerator(seed, wishes)
    options = " ".join(f"--{field.name} {getattr(wishes, field.name):g}" for field in fields(wishes))
    lines = [
        f"# A random arena: python -m robbie_robots.hw.simulation.generate_arena --seed {seed} {options}",
        f"cell_m: {CELL_M:g}",
        f"start_heading_rad: {made.start_heading_rad:.4f}",
        "drawing: |",
    ]
    cells = [["#" if wall else "." for wall in row] for row in made.walls.tolist()]
    cells[made.start[0]][made.start[1]] = "R"
    lines += ["  " + "".join(row) for row in reversed(cells)]
    lines += _listed("circles", [_numbers(circle) for circle in made.circles])
    lines += _listed("boxes", [_numbers(box) for box in made.boxes])
    lines += _listed(
        "victims", [f"{{tag: {tag}, kind: {kind}, {_spot(spot)}}}" for tag, kind, spot in made.victims]
    )
    lines += _listed("signs", [f"{{kind: {kind}, {_spot(spot)}}}" for kind, spot in made.signs])
    lines += _listed(
        "appearing",
        [
            f"{{circle: {_numbers(circle)}, from_s: {begin_s:g}, until_s: {begin_s + APPEARS_FOR_S:g}}}"
            for circle, begin_s in made.appearing
        ],
    )
    return "\n".join(lines) + "\n"


def _listed(key: str, entries: list[str]) -> list[str]:
    return [f"{key}:", *(f"  - {entry}" for entry in entries)] if entries else []


def _numbers(values: tuple[float, ...]) -> str:
    return f"[{', '.join(f'{value:g}' for value in values)}]"


def _spot(spot: WallSpot) -> str:
    keys = ("x_m", "y_m", "height_m", "facing_rad")
    return ", ".join(f"{key}: {getattr(spot, key):g}" for key in keys)


def main(words: Sequence[str] | None = None) -> int:
    """Write an arena to standard output. `words` are the arguments of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m robbie_robots.hw.simulation.generate_arena",
        description="Write a random arena as YAML to standard output.",
    )
    parser.add_argument("--seed", type=int, required=True, help="the same seed makes the same arena")
    for field in fields(ArenaWishes):
        kind = type(field.default)
        parser.add_argument(
            f"--{field.name}", type=kind, default=field.default, metavar=kind.__name__.upper()
        )
    arguments = vars(parser.parse_args(words))
    try:
        sys.stdout.write(generate_arena(arguments.pop("seed"), ArenaWishes(**arguments)))
    except CannotBeArranged as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
