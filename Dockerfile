# momapos alone: docker build -t momapos . && docker run --rm -v "$PWD:/work" momapos place open ...
FROM python:3.12-slim
COPY . /source
# With physics, scans, generated kitchens, the page and xacro; the wheel compiles its kernels as it is built.
RUN pip install --no-cache-dir '/source[kitchens,physics,scan,view,xacro]' && rm -rf /source
RUN useradd --create-home user && mkdir /work && chown user /work
USER user
WORKDIR /work
ENTRYPOINT ["momapos"]
CMD ["--help"]
