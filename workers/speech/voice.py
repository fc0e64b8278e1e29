"""Speaks text by espeak-ng (https://github.com/espeak-ng/espeak-ng), Debian's package of the same name."""

import io
import subprocess
import wave

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

MAX_CHARACTERS = 500
"""Longer texts are cut: the robot could not be interrupted."""
TIME_LIMIT_S = 10.0


class NoVoice(RuntimeError):
    """espeak-ng is not installed, does not know the voice, or failed.

    Example:
        The voice "en-uss".
    """


def speak(text: str, rate_hz: int, voice: str = "en-us", words_per_minute: int = 150) -> NDArray[np.int16]:
    """Return spoken text: (N,) int16.

    Args:
        text: what to say; cut after MAX_CHARACTERS.
        rate_hz: samples each second.
        voice: one of `espeak-ng --voices`.
        words_per_minute: how fast.

    Raises:
        NoVoice: see there.
    """
    command = ["espeak-ng", "-v", voice, "-s", str(words_per_minute), "--stdin", "--stdout"]
    try:
        done = subprocess.run(
            command,
            input=text[:MAX_CHARACTERS].encode(),
            capture_output=True,
            timeout=TIME_LIMIT_S,
            check=False,
        )
    except FileNotFoundError:
        raise NoVoice("the robot's voice needs espeak-ng: sudo apt install espeak-ng") from None
    except subprocess.TimeoutExpired:
        raise NoVoice(f"espeak-ng did not end within {TIME_LIMIT_S:g} s") from None
    told = done.stderr.decode(errors="replace").strip()
    if done.returncode or not done.stdout:
        raise NoVoice(f'espeak-ng failed with the voice "{voice}": {told or f"exit code {done.returncode}"}')
    # It streams its output, so the length in the header is wrong; the samples end with the data.
    with wave.open(io.BytesIO(done.stdout)) as opened:
        own_rate_hz, header = opened.getframerate(), 44
    samples = np.frombuffer(done.stdout[header : len(done.stdout) // 2 * 2], "<i2")
    common = np.gcd(rate_hz, own_rate_hz)
    resampled = resample_poly(samples.astype(float), rate_hz // common, own_rate_hz // common)
    return np.clip(np.round(resampled), -32_768, 32_767).astype(np.int16)
