// The phloSAR's firmware as an Arduino library: call phlosar::setup() in setup() and phlosar::loop() in loop().
#pragma once

#include "run.h"
