"""Linear algebra that fits, evidence and designs of experiments share."""
