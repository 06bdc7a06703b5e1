"""The interactive viewer: `viewer.app.Viewer`."""
