from .causes import Cause, causes_of
from .columns import Cell, Column, Shown, shown_in
from .contents import anchor, case_anchor, verdict_anchor
from .episode_view import (
    Panel,
    decision_at,
    formula_of,
    loop_steps,
    margin_over_time,
    signal_plot,
    signals_csv,
)
from .failure_modes import (
    decision_age_lines,
    decision_time_lines,
    failure_modes_by_component,
    measured_failure_modes,
    percent_text,
)
from .gsn.argument import generated_argument
from .gsn.element import root_ids
from .html.player import pack_data, player_assets, player_data, player_page
from .html.twins import Twin
from .scene import frame_svg
from .searches import outcome_headline
from .tables import case_columns
from .wording import shard_text

__all__ = [
    "Cause",
    "Cell",
    "Column",
    "Panel",
    "Shown",
    "Twin",
    "anchor",
    "case_anchor",
    "case_columns",
    "causes_of",
    "decision_age_lines",
    "decision_at",
    "decision_time_lines",
    "failure_modes_by_component",
    "formula_of",
    "frame_svg",
    "generated_argument",
    "loop_steps",
    "margin_over_time",
    "measured_failure_modes",
    "outcome_headline",
    "pack_data",
    "percent_text",
    "player_assets",
    "player_data",
    "player_page",
    "root_ids",
    "shard_text",
    "shown_in",
    "signal_plot",
    "signals_csv",
    "verdict_anchor",
]
