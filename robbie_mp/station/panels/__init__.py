"""The framework's own panels; `robbie_mp.station.panel_classes` lists them."""
