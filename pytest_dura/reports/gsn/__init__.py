"""The assurance case of a session: an argument in the Goal Structuring Notation.

Rules and keys are those of gsn2x, which draws the notation of the GSN Community Standard,
version 3, from YAML. The argument is generated from the record and asserts nothing by itself.
"""
