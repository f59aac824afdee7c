# %% [markdown]
# # Your own recording
#
# What would the learner have made of a recording, and with how many measurements? Any table will do: a row per time,
# columns with inputs, columns with errors. This one is FL_THERMAL, 46 h of a real machining centre, a row each 5 min
# (benchmarks/recordings/fl_thermal). Its errors are recorded in every row; the learner gets only those it asks for.

# %%
from pathlib import Path

import pandas as pd

import talc

FILE = Path("../../benchmarks/recordings/fl_thermal/fl_thermal.csv")  # yours; from the notebook's folder
table = pd.read_csv(FILE)
times = table.pop("time")  # seconds, or datetimes
errors = [name for name in table.columns if name.startswith("ch")]
print(f"{len(table)} rows, inputs: {', '.join(table.columns.drop(errors))}; errors: {', '.join(errors)}")

# %% [markdown]
# `talc.rehearse` runs the control as if it were live. `uncertainty` measures when the 95 % interval of an error leaves
# 5 µm; `fixed` every two hours, here; `every` uses all that was recorded.

# %%
rehearsals = {
    policy: talc.rehearse(table, errors=errors, policy=policy, times=times)
    for policy in ("uncertainty", "fixed", "every")
}
rows = {}
for policy, result in rehearsals.items():
    left = pd.concat([result[e] - result[f"{e}_predicted"] for e in errors]).dropna()
    recorded = pd.concat([result[e] for e in errors])
    rows[policy] = {
        "measurements": int(result["measured"].sum()),
        "RMSE, µm": round(talc.indicators.rms(left), 2),
        "P99, µm": round(talc.indicators.p99(left), 1),
        "no correction, µm": round(talc.indicators.rms(recorded), 2),
    }
summary = pd.DataFrame(rows).T
print(summary)

# %% [markdown]
# Which decisions led to that? Each step says what it wanted next, and why.

# %%
result = rehearsals["uncertainty"]
print(result.loc[result["wanted"] != "", "wanted"].value_counts().to_string())
# result.to_csv("steps.csv") keeps all of it; `talc-gateway replay FILE --out steps.csv` needs no Python
