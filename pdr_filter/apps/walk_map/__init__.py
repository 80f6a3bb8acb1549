"""Maps of buildings from many walks: walks joined by Wi-Fi, in one frame, without a plan or a survey."""
