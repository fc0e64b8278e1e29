from robbie_mp.bus.core.layout_words cimport *
