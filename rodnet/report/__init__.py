"""Pages and figures of what was recorded, calibrated and diagnosed."""
