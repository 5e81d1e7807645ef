"""A formula on a whole trace: robustness, verdict, margin and vacuity, on NumPy columns."""
