"""Universal files: functions (58), mode shapes (55)."""
