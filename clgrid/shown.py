"""How meshes, grids and hits show themselves: a line at a prompt, a table in a notebook."""

from __future__ import annotations

from base64 import b64encode
from html import escape

Facts = dict[str, str]


class Shown:
    """Whatever can say a few facts of itself, without asking a device."""

    def _headline(self) -> str:
        """What it is, in a few words."""
        raise NotImplementedError

    def _facts(self) -> Facts:
        """What is known of it, by name, in order."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<clgrid.{type(self).__name__} {self._headline()}>"

    def _repr_html_(self) -> str:
        """A table for notebooks."""
        rows = "".join(
            f"<tr><th align='left'>{escape(name)}</th><td align='left'>{escape(text)}</td></tr>"
            for name, text in self._facts().items()
        )
        title = f"clgrid.{type(self).__name__}: {self._headline()}"
        return f"<table><caption>{escape(title)}</caption><tbody>{rows}</tbody></table>"


def below_picture(png: bytes, table: str) -> str:
    """A picture, and a table below it."""
    return f"<div><img alt='' src='data:image/png;base64,{b64encode(png).decode()}'/>{table}</div>"


def counted(count: int, what: str) -> str:
    """``1 ray``, ``2,000 rays``."""
    return f"{count:,} {what}" + ("" if count == 1 else "s")


def shape_text(shape: tuple[int, ...], what: str) -> str:
    """``40 x 30 rays``, ``1 ray``."""
    if len(shape) < 2:
        return counted(shape[0] if shape else 1, what)
    return f"{' x '.join(map(str, shape))} {what}s"
