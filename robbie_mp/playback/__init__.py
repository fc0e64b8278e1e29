"""The logic of playback as plain code; `robbie_mp/services/playback.py` connects it to a run."""
