"""What the two processes say to each other: JSON, a line each."""

from __future__ import annotations

import msgspec

from clgrid.batch.item import Item, ItemRecord


class Hello(msgspec.Struct, tag="hello", frozen=True):
    """To the child, first: the device for items that name none."""

    device: str | None


class Draw(msgspec.Struct, tag="draw", frozen=True):
    """To the child: an item to draw after those before."""

    item: Item


class Hold(msgspec.Struct, tag="hold", frozen=True):
    """To the child, before any item: a file descriptor lies in its socket, to be held as long as it lives."""


class Stop(msgspec.Struct, tag="stop", frozen=True):
    """To the child: finish what is begun, then end."""


class Ready(msgspec.Struct, tag="ready", frozen=True):
    """From the child: its device works."""


class Refused(msgspec.Struct, tag="refused", frozen=True):
    """From the child: there is no such device, or it does not work."""

    error: str


class Turn(msgspec.Struct, tag="turn", frozen=True):
    """From the child: an item's turn has come, or the next stage of it."""

    item: int
    stage: str


class Share(msgspec.Struct, tag="share", frozen=True):
    """From the child: the share of a large picture that is drawn."""

    item: int
    share: float


class Finished(msgspec.Struct, tag="finished", frozen=True):
    """From the child: what became of an item.

    Attributes
    ----------
    again : bool
        Whether it makes sense to try again: the failure was not of the item's own files or settings.
    """

    record: ItemRecord
    again: bool = False


class Ended(msgspec.Struct, tag="ended", frozen=True):
    """The child is gone; its exit code, negative for a signal."""

    code: int


Order = Hello | Hold | Draw | Stop
Event = Ready | Refused | Turn | Share | Finished | Ended

encode = msgspec.json.Encoder().encode
order_of = msgspec.json.Decoder(Order).decode
event_of = msgspec.json.Decoder(Event).decode
