#include <nanobind/nanobind.h>
NB_MODULE(_kernels, m) { m.doc() = "airtact's compiled loops"; }
