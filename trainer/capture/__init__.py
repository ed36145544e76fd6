"""Multi-view recordings on disk, read behind one type: `Capture`."""
