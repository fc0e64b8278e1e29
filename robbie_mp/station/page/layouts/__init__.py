"""Layouts of the page: where tiles of its panels lie, given by the station, by profiles and by operators."""

from robbie_mp.station.page.layouts.collection import LayoutCollection as LayoutCollection
from robbie_mp.station.page.layouts.layout import PLAYBACK as PLAYBACK
from robbie_mp.station.page.layouts.layout import PORTRAIT as PORTRAIT
from robbie_mp.station.page.layouts.layout import Layout as Layout
from robbie_mp.station.page.layouts.layout import LayoutError as LayoutError
from robbie_mp.station.page.layouts.layout import Tile as Tile
from robbie_mp.station.page.layouts.layout import check_layout as check_layout
from robbie_mp.station.page.layouts.layout import default_layouts as default_layouts
from robbie_mp.station.page.layouts.layout import places_of as places_of
from robbie_mp.station.page.layouts.layout import with_panel as with_panel
