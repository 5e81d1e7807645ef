"""``report.html``: one self-contained page that an assessor opens in a browser."""

from pytest_dura.evidence.formats.report.page import FILE, render
from pytest_dura.evidence.formats.report.reading import read_counts

__all__ = ["FILE", "read_counts", "render"]
