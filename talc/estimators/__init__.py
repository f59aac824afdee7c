"""The methods with scikit-learn's conventions, and the rehearsal of a recording; talc's __init__ names them."""

from talc.estimators.cluster_kernel_arx import ClusterKernelARX
from talc.estimators.conventions import NotFittedError
from talc.estimators.group_lasso_arx import GroupLassoARX
from talc.estimators.learner import Learner
from talc.estimators.rehearsal import rehearse
from talc.estimators.sparse_output_error import SparseOutputError

__all__ = ["ClusterKernelARX", "GroupLassoARX", "Learner", "NotFittedError", "SparseOutputError", "rehearse"]
