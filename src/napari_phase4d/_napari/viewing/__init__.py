"""What is shown in the viewer: every layer, and how layers are put side by side."""
