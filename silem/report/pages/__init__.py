"""What serves one page of the book alone, in a module of the page's name."""
