"""The past of the run: its clips in playback beside the live page, and files to take home."""
