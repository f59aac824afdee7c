# %% [markdown]
# # Repeat a paper's table
#
# The studies repeat the papers' experiments on simulated machines, with naive peers beside them and the cases in which
# the method loses (docs/plant.md). This runs a small version of "static, FIR and ARX": eight of its 120 runs. The
# whole study is `make study NAME=arx-vs-static`; its table is in docs/figures.md.

# %%
import subprocess
import sys
import tempfile
from pathlib import Path

with tempfile.TemporaryDirectory() as folder:
    command = [sys.executable, "-m", "studies", "arx-vs-static", "--small", "--out", folder]
    subprocess.run(command, check=True, cwd="../..", stdout=subprocess.DEVNULL)
    summary = (Path(folder) / "summary.md").read_text(encoding="utf-8")

# %% [markdown]
# The right column is the paper's. `ARX` without a guard runs away where sensors are far from the heat and noise-free.

# %%
print(summary)
