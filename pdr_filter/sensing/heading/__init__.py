"""Where the person walks, behind one interface."""
