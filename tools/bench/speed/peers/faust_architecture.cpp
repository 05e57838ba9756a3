// The least that a program made by Faust needs around it: a class to be, and three functions to be called through.
#define FAUSTFLOAT double

#include <algorithm>
#include <cmath>
#include <cstdint>

struct Meta {
    void declare(const char *, const char *) {}
};

struct UI {
    void openVerticalBox(const char *) {}
    void closeBox() {}
};

struct dsp {
    virtual ~dsp() {}
};

<<includeIntrinsic>>

<<includeclass>>

extern "C" {

void *faust_new(int rate) {
    mydsp *made = new mydsp();
    made->init(rate);
    return made;
}

void faust_clear(void *made) { static_cast<mydsp *>(made)->instanceClear(); }

void faust_compute(void *made, int samples, double **inputs, double **outputs) {
    static_cast<mydsp *>(made)->compute(samples, inputs, outputs);
}

void faust_delete(void *made) { delete static_cast<mydsp *>(made); }
}
