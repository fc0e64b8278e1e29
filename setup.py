"""Builds the hot path in C, where there is a compiler; without one, Robbie-MP does the same in Python."""

from pathlib import Path

from setuptools import Extension, setup

SOURCES = Path("robbie_mp/_hot")

setup(
    ext_modules=[
        Extension(
            "robbie_mp._hot.native",
            sources=sorted(str(path) for path in SOURCES.glob("*.c")),
            depends=sorted(str(path) for path in SOURCES.glob("*.h")),
            extra_compile_args=["-std=c11", "-O2", "-Wall", "-Wextra"],
            optional=True,
        )
    ]
)
