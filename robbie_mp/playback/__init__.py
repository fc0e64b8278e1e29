"""What a playback does, as plain code; `robbie_mp/services/playback.py` joins it to a run."""
