"""Conventions of scikit-learn for estimators, besides `fit` and `predict`, without scikit-learn."""

import inspect
from typing import TYPE_CHECKING, Any, Self, cast
from warnings import warn

import numpy as np

from talc.estimators.rows import Inputs, input_rows, outputs_of
from talc.frame import FloatArray

if TYPE_CHECKING:
    from sklearn.utils import Tags


class NotFittedError(ValueError, AttributeError):
    """An estimator was used before `fit`."""


def not_fitted(estimator: object) -> NotFittedError:
    """The error of an estimator that has not been fitted; where scikit-learn is installed, it is also scikit-learn's
    own."""
    text = f"this {type(estimator).__name__} is not fitted yet: call fit first"
    try:
        from sklearn.exceptions import NotFittedError as Theirs
    except ImportError:
        return NotFittedError(text)
    both = type("NotFittedError", (NotFittedError, Theirs), {"__reduce__": lambda _: (not_fitted, (estimator,))})
    return cast(NotFittedError, both(text))


class Conventions:
    """Parameters that can be read, set and cloned; a score; tags.

    A class that derives from it takes its parameters by name in `__init__` and keeps them there unchanged.
    """

    @classmethod
    def _parameters(cls) -> list[str]:
        return [name for name in inspect.signature(cls).parameters if name != "self"]

    def get_params(self, deep: bool = True) -> dict[str, object]:  # noqa: ARG002  # scikit-learn's signature
        """The parameters by name. deep: of no effect, since no parameter is an estimator."""
        return {name: getattr(self, name) for name in self._parameters()}

    def set_params(self, **params: object) -> Self:
        """Set parameters by name. ValueError: there is no such parameter."""
        known = self._parameters()
        for name, value in params.items():
            if name not in known:
                raise ValueError(
                    f"Invalid parameter {name!r} for estimator {self}. Valid parameters are: {', '.join(known)}"
                )
            setattr(self, name, value)
        return self

    def _know(self, rows: Inputs) -> None:
        """Note the inputs that were fitted."""
        self.n_features_in_ = rows.values.shape[1]
        if rows.names is not None:
            self.feature_names_in_ = np.array(rows.names, dtype=object)
        elif hasattr(self, "feature_names_in_"):
            del self.feature_names_in_

    def _following(self, X: object, times: object) -> Inputs:
        """Rows of the inputs that were fitted. ValueError: others."""
        rows, name = input_rows(X, times), type(self).__name__
        if rows.values.shape[1] != self.n_features_in_:
            raise ValueError(
                f"X has {rows.values.shape[1]} features, "
                f"but {name} is expecting {self.n_features_in_} features as input"
            )
        fitted = getattr(self, "feature_names_in_", None)
        if fitted is None and rows.names is not None:
            warn(f"X has feature names, but {name} was fitted without feature names", stacklevel=3)
        elif fitted is not None and rows.names is None:
            warn(f"X does not have valid feature names, but {name} was fitted with feature names", stacklevel=3)
        elif fitted is not None and rows.names != tuple(fitted):
            raise ValueError(_other_names(tuple(fitted), rows.names or ()))
        return rows

    def predict(self, X: object) -> Any:
        """What the rows after the fitted ones lead to."""
        raise NotImplementedError

    def score(self, X: object, y: object) -> float:
        """R² of `predict(X)`, the mean over the errors; rows that were not measured do not count."""
        predicted, (measured, _, _) = np.asarray(self.predict(X), dtype=np.float64), outputs_of(y)
        return _r2(measured, predicted.reshape(measured.shape))

    def __repr__(self) -> str:
        default = {name: p.default for name, p in inspect.signature(type(self)).parameters.items()}
        changed = [
            f"{name}={value!r}" for name, value in self.get_params().items() if repr(value) != repr(default[name])
        ]
        return f"{type(self).__name__}({', '.join(changed)})"

    def __sklearn_tags__(self) -> "Tags":
        """Only scikit-learn asks for it, so it is there."""
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor",
            target_tags=TargetTags(required=True, multi_output=True),
            transformer_tags=None,
            classifier_tags=None,
            regressor_tags=RegressorTags(poor_score=self._poor_score),
            input_tags=InputTags(allow_nan=True),
        )

    _poor_score = False
    """Tells scikit-learn's checks that rows in random order, of no machine, are not predicted well."""


def _other_names(fitted: tuple[str, ...], given: tuple[str, ...]) -> str:
    """In scikit-learn's words, which its checks look for."""
    text = "The feature names should match those that were passed during fit.\n"
    for title, names in (
        ("Feature names unseen at fit time:", sorted(set(given) - set(fitted))),
        ("Feature names seen at fit time, yet now missing:", sorted(set(fitted) - set(given))),
    ):
        text += "".join(f"{line}\n" for line in (title, *(f"- {name}" for name in names)) if names)
    if set(fitted) == set(given):
        text += "Feature names must be in the same order as they were in fit.\n"
    return text


def _r2(measured: FloatArray, predicted: FloatArray) -> float:
    known = np.isfinite(measured) & np.isfinite(predicted)
    scores = []
    for j in range(measured.shape[1]):
        y, p = measured[known[:, j], j], predicted[known[:, j], j]
        around = float(((y - y.mean()) ** 2).sum()) if y.size else 0.0
        left = float(((y - p) ** 2).sum())
        scores.append(1.0 - left / around if around > 0.0 else (1.0 if y.size and left == 0.0 else 0.0))
    return float(np.mean(scores))
