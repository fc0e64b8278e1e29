"""Draws the pictures of the arenas in docs/images: `python -m tools.pictures.arenas`. It takes some seconds.

Each shows an arena from above. On its right is what the robot's camera sees 1.2 m before the first victim.
"""

import argparse
import math
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import VictimKind, WallSpot
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.camera import SimulatedCamera, SimulatedThermalCamera
from robbie_robots.hw.simulation.generate_arena import generate_arena
from robbie_robots.hw.simulation.panel_textures import SIGN_COLOURS
from robbie_robots.hw.simulation.reachable_area import reachable_area

FOLDER = Path("docs/images")
ARENAS = Path("hw/simulation/arenas")
STOCK = ("rescue_maze", "office", "hall")
SEED = 3
HEIGHT_PX = 300
PAPER, INSIDE, WALL, ROBOT = (255, 255, 255), (238, 238, 232), (60, 60, 66), (30, 110, 200)
VICTIM_COLOURS = {
    VictimKind.STILL: (226, 112, 58),
    VictimKind.MOVING: (200, 30, 60),
    VictimKind.COLD: (120, 140, 170),
}


def main() -> int:
    """Write one picture for each stock arena and one for a random one."""
    argparse.ArgumentParser(prog="python -m tools.pictures.arenas", description=__doc__).parse_args()
    for name in STOCK:
        _write(name, read_arena(ARENAS / f"{name}.yaml"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "random.yaml"
        path.write_text(generate_arena(SEED))
        _write("random", read_arena(path))
    return 0


def _write(name: str, arena: Arena) -> None:
    plan, camera, heat = _plan(arena), *_views(arena)
    picture = Image.new("RGB", (plan.width + 10 + camera.width, HEIGHT_PX), PAPER)
    picture.paste(plan, (0, 0))
    picture.paste(camera, (plan.width + 10, 0))
    picture.paste(heat, (plan.width + 10, HEIGHT_PX - heat.height))
    path = FOLDER / f"arena-{name.replace('_', '-')}.png"
    picture.quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {picture.width} x {picture.height}, {path.stat().st_size / 1024:.0f} KiB")


def _plan(arena: Arena) -> Image.Image:
    """Draw the arena from above. The reachable area has a lighter shade."""
    scale = HEIGHT_PX / arena.height_m
    area = reachable_area(arena, resolution_m=0.05)
    shades = np.where(area.free[::-1, :, None], INSIDE, WALL).astype(np.uint8)
    picture = Image.fromarray(shades).resize((round(arena.width_m * scale), HEIGHT_PX))
    draw = ImageDraw.Draw(picture)

    def at(pose: Pose) -> tuple[float, float]:
        return pose.x_m * scale, HEIGHT_PX - pose.y_m * scale

    def mark(spot: WallSpot, colour: tuple[int, int, int], sides: int) -> None:
        before = Pose(spot.x_m, spot.y_m, spot.facing_rad).plus(Pose(0.1, 0.0, 0.0))
        draw.regular_polygon((*at(before), 0.15 * scale), sides, fill=colour, outline=WALL)

    for sign in arena.signs:
        mark(sign.spot, SIGN_COLOURS[sign.kind], 3)
    for victim in arena.victims:
        mark(victim.spot, VICTIM_COLOURS[victim.kind], 12)
    draw.circle(at(arena.start), 0.2 * scale, fill=ROBOT)
    draw.line([*at(arena.start), *at(arena.start.plus(Pose(0.4, 0.0, 0.0)))], fill=ROBOT, width=3)
    return picture


def _views(arena: Arena) -> tuple[Image.Image, Image.Image]:
    """Return the images of camera and thermal camera before the first victim, a little from the side."""
    spot = arena.victims[0].spot
    there = Pose(spot.x_m, spot.y_m, spot.facing_rad).plus(Pose(1.2, 0.15, math.pi + 0.25))
    pictures = []
    for camera in (SimulatedCamera(arena), SimulatedThermalCamera(arena, noise=5.0)):
        camera.place(there, 0.0)
        pictures.append(camera.capture().pixels)
    celsius = pictures[1] / 100 - 273.15
    warm = np.clip((celsius - 15.0) / 25.0 * 255, 0, 255).astype(np.uint8)
    size = (HEIGHT_PX * 2 // 3, HEIGHT_PX // 2)
    return Image.fromarray(pictures[0]).resize(size), Image.fromarray(warm).convert("RGB").resize(size)


if __name__ == "__main__":
    sys.exit(main())
