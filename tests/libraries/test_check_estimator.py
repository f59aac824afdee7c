"""scikit-learn's own checks of estimators, and which of them do not apply."""

import pickle
import subprocess
import sys
from typing import Any

import pytest

import talc

NOT_OF_SERIES = dict.fromkeys(
    ("check_methods_sample_order_invariance", "check_methods_subset_invariance"),
    "what a row leads to depends on the rows before it",
)
ESTIMATORS: list[Any] = [
    talc.Learner(noise=0.1),
    talc.GroupLassoARX(max_nb=1, max_inputs=4),
    talc.ClusterKernelARX(max_nb=0, max_inputs=2),
    talc.SparseOutputError(max_nb=1),
]


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore:y.*its mean is predicted:UserWarning",
    "ignore:y.*uses no input:UserWarning",
    "ignore:.*does not inherit from:UserWarning",
)
@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_the_checks_that_apply_pass(estimator: Any) -> None:
    from sklearn.utils.estimator_checks import check_estimator  # two seconds that `make test` need not spend

    expected = NOT_OF_SERIES if isinstance(estimator, talc.Learner) else {}
    done = check_estimator(estimator, expected_failed_checks=expected, on_skip=None)
    assert {d["check_name"] for d in done if d["status"] == "xfail"} == set(expected)
    assert {d["check_name"] for d in done if d["status"] == "skipped"} <= {"check_array_api_input"}
    assert sum(d["status"] == "passed" for d in done) > 40


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_parameters_are_read_set_and_cloned(estimator: talc.Learner) -> None:
    from sklearn.base import clone  # two seconds that only this test needs to spend

    twin = clone(estimator)
    assert twin is not estimator
    assert twin.get_params() == estimator.get_params()
    assert twin.set_params(step_s=60.0).step_s == 60.0
    assert "step_s=60.0" in repr(twin)
    with pytest.raises(ValueError, match="Invalid parameter 'depth' for estimator"):
        twin.set_params(depth=3)


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_what_is_not_fitted_is_reported_in_both_languages(estimator: Any) -> None:
    from sklearn.base import clone
    from sklearn.exceptions import NotFittedError

    for kind in (talc.NotFittedError, NotFittedError):
        with pytest.raises(kind, match=f"this {type(estimator).__name__} is not fitted yet: call fit first") as told:
            clone(estimator).predict([[1.0]])
        again = pickle.loads(pickle.dumps(told.value))  # as processes send it to each other
        assert isinstance(again, kind)
        assert str(again) == str(told.value)


def test_talc_learns_without_pandas_and_scikit_learn() -> None:
    program = """
import sys
import numpy as np
import talc
sys.modules["pandas"] = sys.modules["sklearn"] = None  # an import of either fails
talc.Learner().fit(np.ones((3, 1)), [0.0, np.nan, 1.0], [0, 300, 900]).predict([[1.0]], times=[1200])
talc.SparseOutputError().get_params()
try:
    talc.Learner().predict([[1.0]])
except talc.NotFittedError as error:
    print(error)
try:
    talc.rehearse({}, errors=["drift"])
except ImportError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    unfitted, without = done.stdout.splitlines()
    assert unfitted == "this Learner is not fitted yet: call fit first"
    assert without.startswith("talc.rehearse needs pandas: install"), done.stderr
