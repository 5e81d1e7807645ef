"""The assurance loop. Knows no domain; needs numpy and the standard library only."""
