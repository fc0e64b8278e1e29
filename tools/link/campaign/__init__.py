"""Kills links and robots at random while two robots exchange messages, and judges their journals."""
