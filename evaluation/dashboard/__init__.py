"""The page that shows a session: served to this computer alone, from one file, without outside addresses."""
