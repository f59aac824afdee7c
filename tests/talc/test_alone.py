"""The science runs, and its tests begin, with NumPy, SciPy and OSQP alone, as docs/library.md installs it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

_PROGRAM = """
import re
import sys
from importlib.metadata import requires

THREE = ("numpy", "scipy", "osqp")
needed = {re.match(r"[A-Za-z0-9_-]+", text)[0].lower() for text in requires("osqp") or () if "extra ==" not in text}
allowed = {"talc", *THREE, *needed, "markupsafe"}  # of jinja2, which osqp needs
of_tests = {"tests", "benchmarks", "simulators", "pytest", "pluggy", "iniconfig", "packaging", "pygments"}
of_tests |= {"py", "hypothesis", "sortedcontainers"}

class OnlyThree:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in sys.stdlib_module_names or top.lower() in allowed or top.startswith("_"):
            return None
        raise ImportError(f"{top} is not installed")

sys.meta_path.insert(0, OnlyThree())

from importlib import import_module
from pkgutil import walk_packages
import numpy as np
import talc

for module in walk_packages(talc.__path__, "talc."):
    import_module(module.name)

draw = np.random.default_rng(1)
X = draw.normal(size=(160, 3)).cumsum(axis=0)
y = np.zeros(160)
for k in range(1, 160):
    y[k] = 0.8 * y[k - 1] + 2.0 * X[k, 1]
for estimator in (
    talc.Learner(),
    talc.GroupLassoARX(max_nb=1, max_inputs=2),  # guarded: by OSQP
    talc.ClusterKernelARX(max_nb=0, max_inputs=1, estimator="refined"),  # by SciPy
    talc.SparseOutputError(max_nb=1, max_inputs=2),
):
    predicted = estimator.fit(X[:120], y[:120]).predict(X[120:])
    print(type(estimator).__name__, bool(np.sqrt(np.mean((predicted - y[120:]) ** 2)) < 0.5 * y[120:].std()))

allowed |= of_tests
import pytest

plain = ("-c/dev/null", "--rootdir=.", "--noconftest", "--import-mode=importlib", "-pno:cacheprovider", "-q")
# What they import and which fixtures they need; they themselves run with the others.
print("tests", pytest.main([*plain, "--setup-plan", "tests/talc"]) == 0)
"""


@pytest.mark.slow
def test_modules_methods_and_tests_run_with_three_libraries() -> None:
    talc = Path(__file__).parents[2]
    plain = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
    program = [sys.executable, "-c", _PROGRAM]
    done = subprocess.run(program, capture_output=True, text=True, check=False, cwd=talc, env=plain)
    assert done.returncode == 0, done.stderr
    names = ("Learner", "GroupLassoARX", "ClusterKernelARX", "SparseOutputError")
    assert {f"{name} True" for name in (*names, "tests")} <= set(done.stdout.splitlines()), done.stdout
