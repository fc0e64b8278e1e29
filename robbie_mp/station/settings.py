"""The settings of the operator station, which its panels read."""

from pathlib import Path

from robbie_mp.module.secret import Secret
from robbie_mp.module.settings import setting


class StationSettings:
    """What a profile can set for an operator station."""

    host: str = setting("127.0.0.1", "address to listen on; 0.0.0.0: all addresses of this machine")
    port: int = setting(8080, "port to listen on; 0: any free port", minimum=0, maximum=65535)
    public_address: str = setting(
        "", "address at which a proxy serves the page, such as https://lab.example/robot1/; '': no proxy"
    )
    trusted_proxies: list[str] = setting(
        [], "addresses or networks of proxies of which X-Forwarded-For and X-Forwarded-Proto are believed"
    )
    operator_token: Secret | None = setting(
        None, "token of operators; null: a new one for each run, in the printed link"
    )
    observer_token: Secret | None = setting(None, "token of observers; null: there are no observers")
    robot_name: str = setting("", "name of the robot, which pages show; '': that of the profile")
    robot_colour: str = setting(
        "", "colour of the robot, which pages show beside its name, such as #ff6f00; '': one of its name"
    )
    panels: list[str] = setting(
        [], "your robot's own panels, each package.module:Class, besides the framework's"
    )
    tabs: dict[str, str] = setting(
        {}, "panels to show, in this order, with their titles ('': the panel's own); {}: all useful panels"
    )
    layouts: dict[str, dict[str, list[int]]] = setting(
        {}, "layouts by name: [x, y, width, height] of each panel on a grid of 24 x 24; {}: none of this name"
    )
    layouts_file: Path | None = setting(
        None, "file with the layouts that operators save; null: in the folder of the run, which ends with it"
    )
    max_linear_m_per_s: float = setting(0.7, "maximum forward speed of manual driving", minimum=0.05)
    max_angular_rad_per_s: float = setting(1.5, "maximum turn rate of manual driving", minimum=0.1)
    map_topic: str = setting("", "topic of the map to show, if the robot has several; '' for any")
    robot_size_m: list[float] = setting(
        [0.45, 0.35, 0.25], "length, width and height of the robot in the 3-D view", minimum=0.01
    )
    robot_model: Path | None = setting(
        None, "shape of the robot in base_link, m, as STL or glTF (.stl, .glb); null: a box", must_exist=True
    )
    poses: dict[str, dict[str, float]] = setting(
        {}, "poses by name, each with the positions (rad) of joints by name; `joints` offers them"
    )
    past_of: dict[str, str] = setting(
        {}, "of a page that plays a clip: `path` of the live page and `title`; the station sets it itself"
    )
    speech_commands: list[str] = setting([], "speech commands of the robot")
    persons: list[str] = setting([], "names of persons that the robot knows")
    objects: list[str] = setting([], "names of objects that the robot knows")
