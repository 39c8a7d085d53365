"""Sources of a watch's samples, its log and its page."""
