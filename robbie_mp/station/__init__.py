"""The operator station: a page, served by the robot, on which an operator observes and steers it.

It is a module like any other, in a separate process, so a page server that hangs or dies affects nothing
else. Needs the extra `gui`.

Rooms: `web` (who may connect), `page` (what every page has), `panels`, `driving`, `stop` (the emergency
stop), `map` and `scene_view` (what they show), `live` (how it gets to the browser), `watch` (what the robot
says).
"""

from robbie_mp.station.station import ExtraMissing, OperatorStation, load_website

__all__ = ["ExtraMissing", "OperatorStation", "load_website"]
