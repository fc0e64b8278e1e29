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
    found = json.loads(file.read_text())
    assert [*found] == [f"{mbit} {kind}" for mbit in MBITS for kind in ("jpeg", "h264")]
    for network, figures in found.items():
        assert figures["is a stream"] == network.endswith("h264"), network
        assert figures["age samples"] >= 10, network
        assert abs(figures["age error p50, s"]) <= MAX_ERROR_S, (network, figures)
