"""What a run of pytest within a test printed."""


def output(result):
    """Both streams of it as one text."""
    return result.stdout.str() + result.stderr.str()
