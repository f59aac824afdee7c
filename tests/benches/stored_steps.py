"""A grid step as the gateway stores it."""

from gateway.model.events import DecisionMade, FrameMade, ModelsAdopted
from gateway.storage.store import Store
from talc.control import Controller
from talc.frame import Decision, Frame
from talc.models import ModelSet
from talc.papers.training import train


def record_step(store: Store, controller: Controller, frame: Frame) -> tuple[Decision, ModelSet | None]:
    """The decision on this frame, and the models of the training that it asks for, adopted at once; None: it asks for
    none. All of it is stored."""
    made = controller.step(frame)
    store.record(FrameMade(frame))
    store.record(DecisionMade(made))
    if made.training is None:
        return made, None
    models = train(made.training)
    controller.adopt(models)
    store.record(ModelsAdopted(models, frame.k))
    return made, models
