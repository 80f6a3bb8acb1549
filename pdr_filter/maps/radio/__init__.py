"""Where a scan of Wi-Fi was heard: a map learnt from walks, and position fixes from it."""
