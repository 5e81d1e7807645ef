"""``report.html``: a self-contained page that an assessor opens in a browser."""
