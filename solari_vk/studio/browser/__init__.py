"""Pictures in a browser: `solari-vk serve`, and what its page shares with the notebook's widget."""
