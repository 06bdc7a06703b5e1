"""What tests share: independent references, written from papers and specifications, scenes and checks."""
