"""Other robots: whose frames have their names before them in the scene graph, as red/base_link."""

from robbie_mp.scene_graph import RigidTransform, SceneGraphError, SceneGraphListener

BASE = "base_link"
MOST_ROBOTS = 32


def other_robots(scene: SceneGraphListener, world: str) -> dict[str, RigidTransform]:
    """Return the newest poses of other robots, X_WB, by their names, as far as they are known.

    Args:
        scene: the scene graph; asked in the thread that keeps it up to date.
        world: the frame W.
    """
    names = [node.name for node in scene.graph if node.name.endswith(f"/{BASE}")]
    found: dict[str, RigidTransform] = {}
    for name in names[:MOST_ROBOTS]:
        try:
            found[name.removesuffix(f"/{BASE}")] = scene.pose(world, name)
        except SceneGraphError:
            continue
    return found
