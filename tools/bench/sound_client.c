/* A sine on PortAudio's default output for some seconds, from C: prints blocks and output underflows.
 *
 *     cc -O2 sound_client.c -lportaudio -lm -o client && ./client 60
 */
#include <math.h>
#include <portaudio.h>
#include <stdio.h>
#include <stdlib.h>

static volatile long blocks, underflows;
static double phase;

static int play(const void *input, void *output, unsigned long frames, const PaStreamCallbackTimeInfo *times,
                PaStreamCallbackFlags flags, void *unused)
{
    float *out = output;
    (void)input, (void)times, (void)unused;
    for (unsigned long i = 0; i < frames; i++) {
        phase = fmod(phase + 440.0 / 44100.0, 1.0);
        out[2 * i] = out[2 * i + 1] = (float)(0.1 * sin(6.283185307179586 * phase));
    }
    blocks++;
    underflows += (flags & paOutputUnderflow) != 0;
    return paContinue;
}

int main(int argc, char **argv)
{
    PaStream *stream;
    double seconds = argc > 1 ? atof(argv[1]) : 60.0;
    if (Pa_Initialize() || Pa_OpenDefaultStream(&stream, 0, 2, paFloat32, 44100.0, paFramesPerBufferUnspecified, play, 0)
        || Pa_StartStream(stream))
        return 1;
    Pa_Sleep((long)(1e3 * seconds));
    printf("{\"blocks\": %ld, \"underruns\": %ld}\n", blocks, underflows);
    fflush(stdout);
    Pa_AbortStream(stream);
    Pa_Terminate();
    return 0;
}
