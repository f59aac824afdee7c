"""The compiled filters of the mixture, under public names. They check nothing: other modules use the mixture."""

from talc._kernel import filters_inform as inform
from talc._kernel import filters_learn as learn
from talc._kernel import filters_look as look
from talc._kernel import filters_rescale as rescale
from talc._kernel import mixtures_gain as gain
from talc._kernel import mixtures_predict as predict

__all__ = ["gain", "inform", "learn", "look", "predict", "rescale"]
