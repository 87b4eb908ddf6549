"""Files that scenes name: written on other systems, moved, in another case."""

from __future__ import annotations

from pathlib import Path, PurePosixPath


def find_beside(folder: Path, name: str) -> Path | None:
    r"""The file that ``name`` means for a scene in ``folder``, None where there is none or more than one.

    Tried in this order: the name as it stands; with ``\`` as ``/``; without regard to case; the last part
    of the name, without regard to case, in the folder and then in the folders right below it.
    """
    written = name.strip().strip('"')
    plain = written.replace("\\", "/")
    drive = len(plain) > 1 and plain[1] == ":"
    try:
        for text in () if drive or plain.startswith("/") else (written, plain):
            if text and (folder / text).is_file():
                return folder / text
        parts = PurePosixPath(plain).parts
        if not parts:
            return None
        if not drive and not plain.startswith("/"):
            found = _same_but_case(folder, parts)
            if found is not None:
                return found
        below = [entry for entry in sorted(folder.iterdir()) if entry.is_dir()]
        for places in ([folder], below):
            matches = [match for place in places for match in _entries(place, parts[-1]) if match.is_file()]
            if matches:
                return matches[0] if len(matches) == 1 else None
    except (OSError, ValueError):  # a name that no file can have: too long, with a zero byte
        return None
    return None


def _same_but_case(folder: Path, parts: tuple[str, ...]) -> Path | None:
    """The only file along ``parts`` but for case."""
    places = [folder]
    for part in parts:
        if part == "..":
            places = [place / ".." for place in places]
        else:
            places = [match for place in places for match in _entries(place, part)]
    files = [place for place in places if place.is_file()]
    return files[0] if len(files) == 1 else None


def _entries(folder: Path, name: str) -> list[Path]:
    if not folder.is_dir():
        return []
    return [entry for entry in sorted(folder.iterdir()) if entry.name.casefold() == name.casefold()]
