"""The methods with scikit-learn's conventions, and the rehearsal of a recording; talc's __init__ names them."""

from talc.estimators.arx import ClusterKernelARX, GroupLassoARX, SparseOutputError
from talc.estimators.conventions import NotFittedError
from talc.estimators.learner import Learner
from talc.estimators.rehearsal import rehearse

__all__ = ["ClusterKernelARX", "GroupLassoARX", "Learner", "NotFittedError", "SparseOutputError", "rehearse"]
