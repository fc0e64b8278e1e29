"""What every page has around its panels: tiles and layouts, the strip at the top, keys, the playback bar."""
