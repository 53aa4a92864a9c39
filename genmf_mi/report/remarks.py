"""What a user should know about a part before printing it, in sentences: for the report and the terminal alike."""

from __future__ import annotations

from typing import Any

from genmf_mi.core.text import printable

LISTED = 6
"""Pieces that are told one by one, the largest first."""
_AS_IT_STANDS = "Less than 2 % of its outline would lie on the bed as it stands"


def remarks(metrics: dict[str, Any]) -> list[str]:
    """How the part stands, what floats free of its body, and what of the file was left out; metrics: as in
    ``metrics.json``."""
    solid = metrics.get("solid") or {}
    written = [*_standing(metrics.get("stand") or {}), *_pieces(metrics.get("pieces") or [])]
    if dropped := (solid.get("stray_bodies_dropped") or 0) + (solid.get("specks_dropped") or 0):
        written.append(
            f"{_count(dropped, 'component')} of less than 1 % of the volume {'was' if dropped == 1 else 'were'} left "
            "out. Join what you miss to the body in a mesh editor."
        )
    return written + [f"Of the file, {printable(note)}." for note in metrics.get("asset_notes") or []]


def _standing(stand: dict[str, Any]) -> list[str]:
    unsteady, auto = stand.get("unsteady"), stand.get("asked") == "auto"
    if auto and not unsteady and stand.get("name") != "upright":
        side = "on a slanted flat side" if stand["name"] == "tilted" else f"{stand['name'].replace('-', ' ')}"
        return [f"{_AS_IT_STANDS}, so it is printed lying, {side}. --stand upright prints it as it stands."]
    if auto and unsteady:
        return [f"{_AS_IT_STANDS}, and it has no flat side to lie on: give it a raft or a brim, and supports."]
    if unsteady:
        return [
            f"Less than 2 % of its outline lies on the bed ({stand.get('name', 'upright')}): give it a raft or a brim, "
            "or let --stand auto lay it on its most stable flat side."
        ]
    return []


def _pieces(pieces: list[dict[str, Any]]) -> list[str]:
    if not pieces:
        return []
    told = "; ".join(map(_piece, pieces[:LISTED])) + (f"; and {len(pieces) - LISTED} more" if pieces[LISTED:] else "")
    return [
        f"{_count(len(pieces), 'piece')} {'floats' if len(pieces) == 1 else 'float'} free of the main body: {told}. "
        "Each comes off the printer by itself, and one that hangs in the air needs supports: join it to the body in a "
        "mesh editor, or delete it."
    ]


def _piece(piece: dict[str, Any]) -> str:
    x, y, _ = piece["centre_mm"]
    size = " × ".join(f"{side:.0f}" if side >= 10 else f"{side:.1f}" for side in piece["size_mm"])
    places = [
        f"{abs(amount):.0f} mm {word}"
        for amount, word in ((x, "to the right" if x > 0 else "to the left"), (y, "behind" if y > 0 else "in front"))
        if abs(amount) >= 1
    ]
    where = " and ".join(places) + " of the middle" if places else "in the middle"
    high = "standing on the bed" if piece["above_bed_mm"] < 0.05 else f"{piece['above_bed_mm']:.0f} mm above the bed"
    return f"{size} mm, {where}, {high}, {piece['gap_mm']:.1f} mm from the body"


def _count(number: int, word: str) -> str:
    return f"{number} {word}" if number == 1 else f"{number} {word}s"
