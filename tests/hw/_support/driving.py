"""Drives a Create 2 on a port forever: a program for tests that kill or stop it."""

import sys
import time

from robbie_robots.hw.irobot.create import CreateBase

if __name__ == "__main__":
    base = CreateBase(sys.argv[1])
    while True:
        base.poll(0.02)
        if base.is_connected:
            base.command(0.2, 0.0, 0.2)
        time.sleep(0.02)
