"""The robot that is sent to places by speaking, with a recording in place of a person."""

import json
import shutil
import wave
from pathlib import Path

import numpy as np
import pytest

from robbie_robots.workers.speech.order_recognizer import RATE_HZ
from robbie_robots.workers.speech.voice import speak
from tests.robot._support.stock_robot import StockRobot

pytestmark = [
    pytest.mark.slow,
    pytest.mark.alone,
    pytest.mark.timeout(240),
    pytest.mark.skipif(shutil.which("espeak-ng") is None, reason="espeak-ng is not installed"),
]
SPOKEN = [
    (8.0, "remember this place as the kitchen"),
    (8.0, "please go to the kitchen"),
    (6.0, "yes"),
    (20.0, ""),
]
"""How long it is silent, and what is said then. The robot answers in the silence.

Each was understood at 24 of 24 places between the recognizer's blocks. Of "go to the kitchen" it understands
15 in this voice: whether it does depends on when the robot has started, and then each time alike.
"""
MAX_TEXTS = 16
"""Texts of the robot while the recording is played some four times."""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a WAV file of a person who teaches the robot a place, and sends it there."""
    file = tmp_path / "spoken.wav"
    with wave.open(str(file), "wb") as opened:
        opened.setnchannels(1)
        opened.setsampwidth(2)
        opened.setframerate(RATE_HZ)
        for silence_s, text in SPOKEN:
            opened.writeframes(bytes(2 * round(silence_s * RATE_HZ)))
            if text:
                opened.writeframes(speak(text, RATE_HZ).astype("<i2").tobytes())
    return file


def test_robot_learns_a_place_by_name_and_is_sent_there_by_voice(robot: StockRobot, recording: Path) -> None:
    robot.start("spoken", "--var", "has_sound_card=false", "--var", f"recording={recording}")
    while "orders" not in robot.top():
        pass
    echo = robot.attach("echo", "speech_msgs/msg/Say", "--json")
    try:
        assert echo.stdout is not None
        said: list[str] = []
        while "I am at the kitchen." not in said and len(said) < MAX_TEXTS:
            said.append(json.loads(echo.stdout.readline())["message"]["text"])
    finally:
        echo.terminate()
        echo.communicate(timeout=30)
    assert said[-1] == "I am at the kitchen.", said
    # It may understand only the second time what is said, and then goes nowhere the first time.
    goes = len(said) - 1 - said[::-1].index("I go to the kitchen.")
    learnt, asked = said.index("This is the kitchen."), said.index("Did you say: please go to the kitchen?")
    assert learnt < goes and asked < goes, said
    robot.close()
    with wave.open(str(robot.output / "recorded_loudspeaker.wav")) as opened:
        samples = np.frombuffer(opened.readframes(opened.getnframes()), "<i2")
    assert np.count_nonzero(np.abs(samples) > 1000) > RATE_HZ  # a second of loud sound, at least
