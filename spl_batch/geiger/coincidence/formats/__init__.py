"""L1 files of users, and frames, detections and points in the working store."""
