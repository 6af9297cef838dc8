"""Options of the stages. No module of them imports torch: a help comes at once."""
