"""Code that tests share: scenes, checks, and reference implementations from papers and specifications."""
