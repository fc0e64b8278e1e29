"""The logic of playback as plain code; `robbie_mp/logs/playback/module.py` connects it to a run."""
