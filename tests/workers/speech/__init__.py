"""Tests of workers/speech."""
