"""The kernel's tests repeated on a kernel built with address and undefined-behaviour sanitizers."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TESTS = (
    "talc/papers/test_free_running.py",
    "talc/papers/test_search.py",
    "libraries/test_group_lasso.py",
    "talc/papers/test_pso.py",
    "talc/learner/test_mixture.py",
)

# Before anything imports it, the sanitized kernel takes the installed one's place.
_PLUGIN = """
import importlib.util, sys
import talc
spec = importlib.util.spec_from_file_location("talc._kernel", {path!r})
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
sys.modules["talc._kernel"] = talc._kernel = module
"""


@pytest.mark.slow
def test_no_address_or_undefined_behaviour_error(tmp_path: Path) -> None:
    target = tmp_path / "kernel"
    build = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    build += ["--target", str(target), "-C", "cmake.define.TALC_SANITIZE=ON", "-C", f"build-dir={tmp_path}/build"]
    build += ["-C", "cmake.define.CMAKE_CXX_FLAGS_RELEASE=-O0 -DNDEBUG"]  # of nanobind; the kernel has its own
    subprocess.run([*build, str(ROOT)], check=True, timeout=300)
    (kernel,) = (target / "talc").glob("_kernel*.so")
    (tmp_path / "sanitized.py").write_text(_PLUGIN.format(path=str(kernel)), encoding="utf-8")
    # The C++ runtime too, or the sanitizer would not find the function that throws.
    libraries = [
        subprocess.run(["g++", f"-print-file-name={name}"], check=True, capture_output=True, text=True).stdout.strip()
        for name in ("libasan.so", "libstdc++.so")
    ]
    environment = os.environ | {
        "LD_PRELOAD": " ".join(libraries),
        "ASAN_OPTIONS": "detect_leaks=0",
        "PYTHONPATH": str(tmp_path),
    }
    run = [sys.executable, "-m", "pytest", "-q", "-p", "sanitized", "-p", "no:cacheprovider"]
    run += [str(ROOT / "tests" / name) for name in TESTS]
    done = subprocess.run(run, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    assert "passed" in done.stdout
