"""Redaction: no secret enters what a session leaves behind."""
