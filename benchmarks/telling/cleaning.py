"""What strangers wrote (titles, notes, names, reasons, messages), made harmless once for each kind of output.

Terminal and HTML: nothing that steers; Markdown: no tags, links, cells or headings; LaTeX: no commands, no lost letter;
CSV: no formulas."""

from __future__ import annotations

import re
import sys
import unicodedata
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TextIO

from .marks import ASCII

if TYPE_CHECKING:
    import pandas as pd

_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Controls (C0 but tab and newline, C1), what turns the direction of writing, lines that are none, half letters."""
_FORMULA = re.compile(r"[=+@\t\r-].")
_TAG = re.compile(r"<(?=[A-Za-z/!?])")
_ACCENTS = dict(zip("\u0300\u0301\u0302\u0303\u0304\u0306\u0307\u0308\u030a\u030b\u030c\u0327\u0328", "`'^~=u.\"rHvck",
                    strict=True))
"""Combining accents and LaTeX's commands for them."""
_GREEK = re.findall(r"\w+", "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda nu xi pi rho sigma tau "
                    "upsilon varphi chi psi omega Gamma Delta Theta Lambda Xi Pi Sigma Phi Psi Omega")
_LATEX = {
    **{letter: f"\\{letter}" for letter in "&%_#${}"}, "\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}",
    "<": "$<$", ">": "$>$", "±": r"$\pm$", "−": "$-$", "–": "--", "·": r"$\cdot$", "×": r"$\times$",
    "∞": r"$\infty$", "µ": r"$\mu$", "‰": r"\textperthousand{}", "ß": r"\ss{}", "æ": r"\ae{}", "Æ": r"\AE{}",
    "ø": r"\o{}", "Ø": r"\O{}", "œ": r"\oe{}", "Œ": r"\OE{}", "ł": r"\l{}", "Ł": r"\L{}", "ı": r"\i{}", "„": ",,",
    "“": "``", "”": "''", "‘": "`", "’": "'", "—": "---", "°": r"$^\circ$", "§": r"\S{}",
    **{letter: f"$\\{name}$" for letter, name in zip("αβγδεζηθικλνξπρστυφχψωΓΔΘΛΞΠΣΦΨΩ", _GREEK, strict=True)},
    "μ": r"$\mu$",
    **{raised: f"$^{{{digit}}}$" for raised, digit in zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789", strict=True)}}


def visible(text: str) -> str:
    """What steers a terminal or a page as its number: `\\x1b`, `\\u202e`."""
    return _STEERING.sub(lambda found: f"\\x{ord(found[0]):02x}" if ord(found[0]) < 256 else f"\\u{ord(found[0]):04x}",
                         text)


def one_line(text: object) -> str:
    """The same on one line."""
    return " ".join(visible(str(text)).split())


def plain(text: str, encoding: str | None = None) -> str:
    """A text in letters that an encoding (None: that of standard output) has."""
    encoding = str(encoding or sys.stdout.encoding or "utf-8")
    try:
        text.encode(encoding)
        return text
    except UnicodeEncodeError:
        for sign, words in ASCII.items():
            try:
                sign.encode(encoding)
            except UnicodeEncodeError:
                text = text.replace(sign, words)
        return text.encode(encoding, "replace").decode(encoding)


class Cleaned:
    """A text stream to a terminal or a log that passes nothing on that steers it, or that it cannot encode."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write it, cleaned."""
        self.stream.write(plain(visible(text), self.stream.encoding))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def raw(stream: Any) -> Any:
    """What is under a `Cleaned` stream, for what itself steers the terminal."""
    return stream.stream if isinstance(stream, Cleaned) else stream


def markdown(text: object) -> str:
    """Text for a heading, a line of a list or a cell of a table."""
    return _TAG.sub("&lt;", one_line(text)).replace("|", "\\|").replace("](", "]\\(")


def latex(text: object) -> str:
    """Text for LaTeX in plain ASCII: letters with their accents, others by number; signs without a word are `?`."""
    return "".join(map(_tex, one_line(text))).replace("}$$^{", "")


def _tex(letter: str) -> str:
    if letter in _LATEX:
        return _LATEX[letter]
    base, *accents = unicodedata.normalize("NFD", letter)
    if base.isascii() and all(accent in _ACCENTS for accent in accents):
        for accent in accents:
            base = f"\\{_ACCENTS[accent]}{{{base}}}"
        return base
    return f"[U+{ord(letter):04X}]" if letter.isalpha() else "?"


def csv(frame: pd.DataFrame) -> str:
    """A table as CSV in which no text is a formula to a spreadsheet."""
    words = [name for name in frame.columns if str(frame[name].dtype) in ("object", "str", "string")]
    return frame.assign(**{str(name): frame[name].map(csv_text) for name in words}).to_csv(index=False)


def csv_text(value: Any) -> Any:
    """A value of a cell; of text, one that no spreadsheet computes."""
    return _csv_word(value) if isinstance(value, str) else value


@lru_cache(maxsize=10_000)
def _csv_word(text: str) -> str:
    text = visible(text)
    try:
        float(text)
        return text
    except ValueError:
        return f"'{text}" if _FORMULA.match(text) else text
