"""The devices that a profile names: whether they are there, and whether this user may use them."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from robbie_mp.base.problem import ProfileError
from robbie_mp.run.doctor.finding import Finding, fail, ok
from robbie_mp.run.exclusive_use import named_devices
from robbie_mp.run.profile.model import Profile
from robbie_mp.run.profile.preflight import preflight


def look_at_devices(profile: Profile) -> Iterator[Finding]:
    """Look for each device that a module's settings name by its path, in the profile or by default."""
    try:
        checked = preflight(profile).settings
    except ProfileError:  # which is another finding
        checked = {}
    modules = [replace(one, settings=checked.get(one.name, one.settings)) for one in profile.modules]
    for setting, device in named_devices(modules):
        if device.startswith("/"):
            yield check_device(setting, device)


def check_device(setting: str, path: str) -> Finding:
    """Judge the device that a setting names."""
    check = f"device {setting}"
    if not Path(path).exists():
        return fail(check, f"{path} is not there", "plug it in, or see `robbie devices` for what is there")
    if not os.access(path, os.R_OK | os.W_OK):
        return fail(check, f"you may not use {path}", "see the finding on serial ports, or ls -l the device")
    return ok(check, f"{path} is there")
