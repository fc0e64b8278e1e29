"""On a test network of the kernel, the page shows the true age of its picture, and loads soon."""

import json
from pathlib import Path

import pytest

from tests.station._support.browser import needs_chromium
from tools.operator.video import main
from tools.test_network.network import Network, NoTestNetwork

pytestmark = [needs_chromium, pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(500)]
MAX_ERROR_S = 0.1
MBITS = (20.0, 5.0, 1.0, 0.3)


def test_shown_age_is_the_true_one_over_four_networks(tmp_path: Path) -> None:
    try:
        with Network("probe"):
            pass
    except NoTestNetwork as why:
        pytest.skip(f"AGES ARE NOT COMPARED OVER TEST NETWORKS: {why}")
    file = tmp_path / "video.json"
    main(["--mbit", *map(str, MBITS), "--seconds", "3", "--json", str(file)])
    found = {float(mbit): figures for mbit, figures in json.loads(file.read_text()).items()}
    assert [*found] == [*MBITS]
    for mbit, figures in found.items():
        assert figures["age samples"] >= 10, mbit
        assert abs(figures["age error p50, s"]) <= MAX_ERROR_S, (mbit, figures)
