import sys
from setuptools import setup, Extension
from Cython.Build import cythonize
import glob, os
mods = sys.argv[1].split(","); sys.argv = ["x", "build_ext", "--inplace", "-q"]
exts = [Extension(m.replace("/", ".").rsplit(".",1)[0], [m], extra_compile_args=["-O2","-g0"], include_dirs=["robbie_mp/bus/_hot"]) for m in mods]
setup(name="x", ext_modules=cythonize(exts, language_level=3, annotate=False, quiet=False, compiler_directives=dict(binding=True, cdivision=True, initializedcheck=False)), packages=[])
