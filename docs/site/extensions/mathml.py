"""Formulas as MathML, which browsers draw by themselves: the site needs no script from elsewhere and works offline."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx

BAR = re.compile(r"<mo[^>]*>\|</mo>")  # closing bars would get an operator's spaces


def drawn(tex: str, block: bool) -> str:
    return BAR.sub('<mo stretchy="false" lspace="0" rspace="0">|</mo>', tex2mathml(tex, as_block=block))


def inline(self: Any, node: nodes.math) -> None:
    self.body.append(drawn(node.astext(), block=False))
    raise nodes.SkipNode


def block(self: Any, node: nodes.math_block) -> None:
    self.body.append(self.starttag(node, "div", CLASS="math-block"))
    self.body.append(drawn(node.astext(), block=True))
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
