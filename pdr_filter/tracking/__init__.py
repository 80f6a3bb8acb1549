"""Online filter for apps, tracks of whole recordings, and warnings about a track."""
